# SPDX-License-Identifier: Apache-2.0
"""Helpers shared by tests: emulated boards, faulty rigs, a browser, a daemon process."""
