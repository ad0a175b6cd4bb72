"""The paper's coder (section 4.3, figure 4; section 5.2), the permanent baseline, and its quantisers."""
