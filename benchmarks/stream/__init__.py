"""Streaming: recorded lines, sockets, scale."""
