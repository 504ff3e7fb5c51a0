"""What networks share: encoders, decoder, checkpoints, arithmetic, training."""
