"""Chapter 8 on many references: the sudden CG shift in every mode, classical laws included."""
