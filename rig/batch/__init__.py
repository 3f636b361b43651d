"""One way to run many things: cases on an engine, a journal of what is done, a table of what came out."""
