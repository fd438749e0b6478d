"""What a model is: frozen values, types of numbers, choices by kind, trust of files, numbers in JSON.

Nothing here knows of a message, a pursuer or a command.
"""
