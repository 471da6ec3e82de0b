"""LunarLander as in the thesis's chapter 4, measured: learning curves, faults, behaviours, picks from a repertoire."""
