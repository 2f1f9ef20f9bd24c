"""Figures of the stream and the bridge, for `clothrf bench robot`."""
