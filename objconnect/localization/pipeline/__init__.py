"""The everyday job: photographs, sequences and videos in, poses and their files out."""
