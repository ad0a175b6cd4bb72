"""Pictures of force fields and of what a coder did to them."""

from touchfield.rooms import modules_of

__getattr__ = modules_of(__name__)
