def synthesise(data, grid, lattice):
    raise AssertionError
