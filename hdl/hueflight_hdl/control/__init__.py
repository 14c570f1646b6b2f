# SPDX-License-Identifier: Apache-2.0
"""The control protocol in gateware, for both boards: register file and request engine."""
