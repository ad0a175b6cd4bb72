"""Devices: what each haptic display can show (paper sections 3.1 and 5.1), from TOML profiles."""

from touchfield.devices.profile import Device, device, device_names, devices

__all__ = ["Device", "device", "device_names", "devices"]
