"""Relief above the bump-mapped plane is put into boxes."""
