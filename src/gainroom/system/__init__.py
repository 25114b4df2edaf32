"""What a user describes, and the loop it makes: plant, drive, controller, requirements, uncertainty."""
