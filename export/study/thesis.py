"""The thesis's own figures, which stand beside ours in every table."""

from __future__ import annotations

from typing import NamedTuple


class Published(NamedTuple):
    """A mean and its standard deviation."""

    mean: float
    sd: float

    def __str__(self) -> str:
        return f"{self.mean:.2f} ± {self.sd:.1f}"


class Row(NamedTuple):
    """One row of table 7.1: nMAE [%]."""

    td3: Published
    average: Published
    champion: Published


TABLE_71 = {
    "nominal": Row(Published(7.43, 1.6), Published(6.55, 1.5), Published(4.14, 1.0)),
    "F1": Row(Published(7.89, 1.5), Published(7.59, 2.4), Published(4.73, 0.8)),
    "F2": Row(Published(7.41, 1.4), Published(7.87, 2.0), Published(4.80, 0.8)),
    "F3": Row(Published(7.52, 1.6), Published(6.55, 1.5), Published(4.14, 1.0)),
    "F4": Row(Published(8.04, 1.9), Published(7.07, 1.4), Published(4.74, 1.5)),
    "F5": Row(Published(8.63, 1.9), Published(13.68, 6.2), Published(8.08, 1.3)),
    "F6": Row(Published(37.31, 0.5), Published(73.97, 21.3), Published(39.58, 0.9)),
    "R1": Row(Published(10.06, 0.8), Published(8.201, 3.3), Published(4.15, 0.5)),
    "R2": Row(Published(11.53, 2.2), Published(11.36, 5.3), Published(6.68, 1.6)),
    "R3": Row(Published(7.13, 1.4), Published(6.94, 1.5), Published(4.74, 1.2)),
}
"""TD3, the average of SERL(50) and its champion (30 references from three seeds)."""
BEST_71 = dict.fromkeys(TABLE_71, "champion") | {"F5": "", "F6": "td3"}
"""Which is printed bold: significantly lower than the rest."""

RETURN_TD3 = Published(-78.9, 21.3)
"""Return of 20 s of the TD3 actor without regularisation (section IV.D)."""
RETURN_CHAMPION = (-80.0, -71.0)
"""Range of the SERL(50) champion's returns of 20 s (figures 3 and 8)."""
SM_TD3 = Published(-1500.0, 123.0)
SM_SERL50 = Published(-5.0, 1.0)
"""Sm [rad Hz] (section IV.D)."""

MUTATION_MAGNITUDE = 2.47e-2
"""sigma_mut of SERL(10)."""
MUTATION = {
    ("safe", "gaussian"): "lower, p = 7e-6; unsafe: a quarter",
    ("safe", "proximal"): "higher, p = 4e-3; unsafe: half",
    ("gaussian", "proximal"): "higher, p = 6e-10; unsafe: higher, p = 5e-8",
}
"""Change of return and of unsafe samples over one generation of 10 actors on 30 references (section 6.2)."""
