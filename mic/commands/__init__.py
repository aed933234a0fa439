"""What the commands of ``mic`` do, one file a command or kind of command; :mod:`mic.options` declares them."""
