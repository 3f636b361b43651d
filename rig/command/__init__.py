"""The verbs of the command line, a file each; a verb's imports are its own, so that none waits for another's."""
