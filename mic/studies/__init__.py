"""Studies of a model beyond a run: contributors, sensitivities, process orders, rare violations, optimisation, …"""
