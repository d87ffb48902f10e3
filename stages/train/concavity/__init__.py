"""Concavities: hollows that no silhouette shows, found where another depth explains the photographs better."""
