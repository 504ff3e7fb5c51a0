"""Text files of a flight: poses, priors, cameras, origin."""
