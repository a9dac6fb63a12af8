"""Readers of exported programmes, and the machine that runs what they read."""
