"""Sample files and subjects that tests of several folders write or break."""
