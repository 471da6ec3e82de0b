"""What flies: the fixed-rate loop, the model learnt in flight, the imagination and the switch."""
