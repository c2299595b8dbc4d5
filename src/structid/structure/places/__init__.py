"""Where sensors and forces are that no degree of freedom alone names: on lines, on meshes, several as one."""
