"""The campaign: faults x references x ways of adapting, flown in process, with paired statistics."""
