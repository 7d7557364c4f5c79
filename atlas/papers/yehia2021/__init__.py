"""Yehia & El-kenani 2021: the magnetised satellite-gyrostat on a circular orbit."""
