"""The bench's page and its HTTP interface, in a process of its own: it never holds a port."""
