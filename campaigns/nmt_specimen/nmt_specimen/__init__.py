"""The simulated rig behind a converter's ports: stand-ins of sound card and NI device server."""
