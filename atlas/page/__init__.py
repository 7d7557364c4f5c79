"""One HTML file that shows an atlas: map, values and motions, without a server."""
