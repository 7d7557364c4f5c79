"""Questions to an atlas that are answered by numbers, tables and text, without figures."""
