"""One Lafortune lobe per texel."""
