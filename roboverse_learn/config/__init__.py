"""Configuration of the commands: schema, composition, serialization, help, and checks before a run."""
