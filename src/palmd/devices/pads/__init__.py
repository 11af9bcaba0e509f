"""Touch pad drivers, one module per kind; `palmd.devices.pad` imports them by the configuration's `kind`."""
