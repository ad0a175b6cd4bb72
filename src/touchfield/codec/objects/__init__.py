"""The coder `objects`: the object source model of figure 4 (paper section 4.3), fields with poses."""
