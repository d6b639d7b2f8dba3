"""The commands of the benchmarks. Each module has the commands for one subject of measurement."""
