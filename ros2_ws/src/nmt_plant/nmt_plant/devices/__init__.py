"""Devices behind the contract: simulated rig, hardware, loopback."""
