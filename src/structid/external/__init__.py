"""A finite element solver in the loop: decks with marked numbers, runs that are kept, and models made of what they give."""
