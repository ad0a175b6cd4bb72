"""Coder `paper`, the coder that the paper describes (sections 4.3 and 5.2, figure 4). It stays in the package
as the baseline that coder `touch` is compared with."""
