"""Parts that networks share: encoder, decoder, checkpoints, inference and training."""
