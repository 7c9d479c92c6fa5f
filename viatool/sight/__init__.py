"""What a LiDAR reads anywhere in boxes of poses, as linear forms with a guaranteed rest."""
