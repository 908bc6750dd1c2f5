"""Who makes the puppet: a body sculpted by a program, and pictures to judge any body by."""
