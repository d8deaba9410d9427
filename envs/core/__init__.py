"""What every other package needs: errors, the registry, atomic files. Standard library only."""
