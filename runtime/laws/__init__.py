"""The honest peers: classical attitude laws on the same link, references and faults as the policies (docs/laws.md)."""
