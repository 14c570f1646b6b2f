"""From histograms to images: depth, reflectance, uncertainty and the limits of all three."""
