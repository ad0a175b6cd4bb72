def fit(frame, lattice, limits):
    return None
