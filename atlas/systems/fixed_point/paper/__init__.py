"""What Amer, Abo Essa, Ibrahim & Amer (2013) print, beside what is true."""
