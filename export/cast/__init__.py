"""The default cast: members bred one by one for what only a fault makes right, then chosen for coverage."""
