"""Compiled loops: pure functions on arrays, without the interpreter's lock; a test has a plain form of each.

A `.pyx` reads like the formula and checks shapes. Where time is in products and sums of whole rows, it calls a C
header that is compiled for each of the machine's vector widths (`widths.h`).
"""
