"""The lattice of micro-images where there is no white picture: from dots, bars, or what is plain
white in them.
"""
