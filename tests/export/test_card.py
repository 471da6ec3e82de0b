"""The model card: what it says of members that are changed copies of others."""

import pytest

from export.card import card
from export.gains import with_gains
from export.mirrors import with_mirrors
from export.network import Layer, Network

TANH = Network(layers=(Layer(units=12), Layer(units=3)))
MIRRORS, GAINS = "`A/-ea` is A with", "`A/beta_e*8+r*0.5` is A that sees"


@pytest.mark.parametrize(
    ("change", "told", "untold"),
    [
        (lambda cast: with_mirrors(cast, "run"), [MIRRORS], [GAINS]),
        (lambda cast: with_gains(cast, "run"), [GAINS], [MIRRORS]),
        (lambda cast: with_gains(with_mirrors(cast, "run"), "run"), [MIRRORS, GAINS], []),
        (lambda cast: cast, [], [MIRRORS, GAINS, "Of the names"]),
    ],
)
def test_the_card_explains_the_names_that_are_there(make_actors, change, told, untold):
    text = card(change(make_actors(TANH)), "four", {}, None)
    assert all(each in text for each in told)
    assert not any(each in text for each in untold)
    assert "this card is for people.\n\n" in text
    assert "\n\n## Intended use\n" in text
    assert "\n\n\n" not in text.partition("## Limits")[0]
