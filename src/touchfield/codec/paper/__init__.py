"""The paper's coder (section 4.3, figure 4; section 5.2), the baseline for ever, and the quantisers it is
made of.
"""
