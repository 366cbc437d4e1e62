"""Displays that compiled loops are tried on: views and disparities of their layers."""

SHOWN = {
    "three layers": "views = [3, 3]\ndisparity = [1, 0, -1]",
    "two layers, fractions": "views = [3, 4]\ndisparity = [0.7, -0.4]",
    "one layer": "views = [2, 2]\ndisparity = [0.0]",
    "six layers": "views = [2, 3]\ndisparity = [2, 1, 0.5, 0, -1, -2]",
    "one row": "views = [1, 5]\ndisparity = [1.3, 0, -1]",
}
