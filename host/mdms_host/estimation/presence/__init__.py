"""What presence sensors show, and what each has been worth."""
