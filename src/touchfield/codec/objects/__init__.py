"""The coder `objects`: fields with poses (figure 4's object source model)."""
