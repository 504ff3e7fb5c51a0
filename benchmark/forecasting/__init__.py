"""The command ``forecast``: where along a flight a method will find fixes, by season."""
