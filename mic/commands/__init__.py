"""The commands of ``mic``, one file each or one for a kind; :mod:`mic.options` declares their options."""
