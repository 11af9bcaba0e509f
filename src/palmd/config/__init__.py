"""Configuration and motion plans as strict, frozen models: units in every key, unknown keys are errors."""
