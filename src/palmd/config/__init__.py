"""Configuration and motion plans as strict, frozen models: units in every key, nothing unknown accepted."""
