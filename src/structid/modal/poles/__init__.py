"""Poles of a vibrating structure: what physical ones meet, which of them are a mode, and what a window adds to them."""
