"""The built-in robots, one YAML file each (see :mod:`swimid.formats.robot`)."""
