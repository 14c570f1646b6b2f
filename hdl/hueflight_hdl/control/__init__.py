"""The control protocol in gateware, for both boards: register file and request engine."""
