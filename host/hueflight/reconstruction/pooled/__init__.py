"""Images from few photons per pixel, estimated over adaptive neighborhoods."""
