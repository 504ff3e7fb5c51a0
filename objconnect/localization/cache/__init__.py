"""What a method keeps per map: arrays in files under keys of what they were made of."""
