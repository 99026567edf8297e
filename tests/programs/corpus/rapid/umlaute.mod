MODULE Schweißen
  ! Äußere Naht, geprüft am 3. März
  CONST robtarget pNähe:=<7|torch|table>;
  CONST robtarget pÜber:=<8|torch|table>;
  CONST string stMeldung:="Tür öffnen! [[1,2,3],[1,0,0,0]]";
  PROC Naht_außen()
    MoveJ pÜber,v1000,z10,torch\WObj:=table;  ! über dem Anfang
    MoveL pNähe,v100,fine,torch\WObj:=table;
    TPWrite stMeldung;
    MoveL Offs(pNähe,25,0,0),v10,fine,torch\WObj:=table;
  ENDPROC
ENDMODULE
