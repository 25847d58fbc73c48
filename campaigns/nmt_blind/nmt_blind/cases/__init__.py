"""The generator of truth for the blind check; shares no solver with the diagnosis."""
