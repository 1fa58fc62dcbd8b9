"""From configuration to what a tick needs: tables, filters, compensation, stability; rendering offline."""
