"""LeRobotDataset v3 on disk: writer, reader, statistics, recovery."""
