"""Proximal policy optimization: settings, network, policy."""
