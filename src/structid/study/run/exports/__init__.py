"""An identified model in files of other programs, one kind of content a module; `offers` lists what a results folder can give."""
