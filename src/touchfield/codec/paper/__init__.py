"""The paper's coder (sections 4.3 and 5.2, figure 4), a permanent baseline."""
