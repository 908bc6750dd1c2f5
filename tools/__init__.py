"""Programs that make files of this repository; they are not in the installed package."""
