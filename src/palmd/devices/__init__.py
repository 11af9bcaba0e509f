"""Bytes to events and back: codecs of touchpads and arm, the arm's host side, and the serial ports."""
