"""Commands for the benchmarks on a server: phases, teams, submissions, leaderboards."""
