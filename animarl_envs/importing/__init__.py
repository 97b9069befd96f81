"""From tracks to demonstrations: reading, cleaning, scaling, cutting."""
