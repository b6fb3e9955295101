"""Damage, hostile clients, kills, outliers, and memory: what must not break."""
