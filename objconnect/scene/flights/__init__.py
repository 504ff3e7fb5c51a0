"""Text files of a flight: poses, priors (approximate poses), cameras, origin."""
