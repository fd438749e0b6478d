"""Who performs runs: processes of this machine, a cluster or the executor of the caller, with time limits and progress.

Results do not depend on the workers; tests compare one worker with many.
"""
