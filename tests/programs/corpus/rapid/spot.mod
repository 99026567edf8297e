MODULE Spots
  PERS gundata g1:=["",1,0,0.1,0.1,0.05,0.5,5];
  CONST robtarget s10:=<17|torch|table>;
  CONST robtarget s20:=<18|torch|table>;
  CONST robtarget s30:=<19|torch|table>;
  PROC weld()
    MoveJ Offs(s10,0,0,50),vmax,z50,torch\WObj:=table;
    SpotL s10,vmax,g1,sp10,torch\WObj:=table;
    SpotL s20,vmax\InPos,g1,sp10,torch\WObj:=table;
    SpotJ s30,vmax,g1,sp20,torch\WObj:=table;
  ENDPROC
ENDMODULE
