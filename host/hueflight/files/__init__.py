"""Files that are whole or absent, their checksums, and the layout of an image."""
