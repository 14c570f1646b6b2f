"""The joint maximum-likelihood fit: tables, reference implementation, compiled solver."""
