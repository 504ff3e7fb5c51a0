"""The command ``forecast``: where along a flight a method will find accurate poses, by season."""
