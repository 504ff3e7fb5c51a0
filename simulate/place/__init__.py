"""Places as plain data: what stands where."""
