"""What Yehia & El-kenani (2021) print, beside what is true."""
