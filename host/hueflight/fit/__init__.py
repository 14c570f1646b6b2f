"""The joint maximum-likelihood fit: tables, NumPy definition and compiled solver."""
