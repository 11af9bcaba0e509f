"""Device drivers: codecs of touch pads and actuators, host state machines, and serial ports."""
