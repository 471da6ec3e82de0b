"""Safety-informed evolutionary reinforcement learning: TD3 and a genetic population."""
