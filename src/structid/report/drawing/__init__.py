"""Structures as flat shapes."""
