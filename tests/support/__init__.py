"""Helpers shared by tests: emulated boards, faulty rigs, a browser, a daemon process."""
