"""What every command shares: kinds of arguments, errors, progress, optional packages, the files that palmd ships."""
