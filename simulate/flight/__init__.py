"""Planning of flights, and checks that they can be flown."""
