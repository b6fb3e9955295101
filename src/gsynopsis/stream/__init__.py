"""Bytes over a network: sources, policies and the session that makes levels of them. No torch."""
