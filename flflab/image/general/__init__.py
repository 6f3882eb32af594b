"""Any scene, by blocks of rays."""
