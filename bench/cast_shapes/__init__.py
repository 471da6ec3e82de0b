"""Which shape should a member have? The same search, with as many frames, with and without a hidden layer."""
