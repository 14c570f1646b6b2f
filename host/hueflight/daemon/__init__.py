"""The capture daemon: one camera, one live picture, an API, and no photon lost unnoticed."""
