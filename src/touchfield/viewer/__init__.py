"""Pictures of force fields and of what a coder did to them."""
