"""What if: sensitivity of an optimum, sweeps over what is given, on the processes of this machine or on a cluster."""
