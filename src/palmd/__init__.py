"""palmd: an unknown planar object on two touchpad palms, reconstructed live."""

__version__ = "0.1.0"
