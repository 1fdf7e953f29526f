"""What makes a scenario one that can be run; what each table of it may say."""
