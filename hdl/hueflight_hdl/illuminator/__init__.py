"""The illuminator: the pulse generator, its gearing to the pins, arming and registers."""
