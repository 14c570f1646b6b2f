"""The camera: exposures, the interface to a sensor, the frame formatter and its messages."""
